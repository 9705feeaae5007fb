/* The sky of the teapots scene: what a ray sees that misses everything. dir: world space. */
color sky(vector dir) {
  vector d = normalize(dir);
  float h = ycomp(d);
  color horizon = color(0.75, 0.80, 0.88);
  color zenith = color(0.16, 0.30, 0.62);
  color ground = color(0.22, 0.20, 0.18);
  color c = mix(horizon, zenith, smoothstep(0, 0.8, h));
  c = mix(c, ground, 1 - smoothstep(-0.05, 0.02, h));
  /* a soft box light overhead gives glass and chrome something to show */
  float box = smoothstep(0.80, 0.83, h) * (1 - smoothstep(0.27, 0.30, abs(xcomp(d))));
  return c + 2.2 * box * color(1, 0.97, 0.9);
}
