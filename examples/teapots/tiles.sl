/* Checkered floor in shader space (x, z), box filtered. */
float pulse(float x, fw) {
  /* integral of the square wave that is 1 on [0, .5): its difference over fw is the filtered value */
  float a = x - 0.5 * fw, b = x + 0.5 * fw;
  float ia = floor(a) * 0.5 + min(mod(a, 1), 0.5);
  float ib = floor(b) * 0.5 + min(mod(b, 1), 0.5);
  return (ib - ia) / fw;
}

surface tiles(float Ka = 0.25, Kd = 0.75, size = 1.6; color dark = color(0.20, 0.22, 0.26)) {
  point Q = transform("shader", P) / (2 * size);
  float x = xcomp(Q), z = zcomp(Q);
  float fx = max(abs(Du(x) * du) + abs(Dv(x) * dv), 1.0e-4);
  float fz = max(abs(Du(z) * du) + abs(Dv(z) * dv), 1.0e-4);
  float sx = pulse(x, fx), sz = pulse(z, fz);
  float check = sx * sz + (1 - sx) * (1 - sz);
  normal Nf = faceforward(normalize(N), I);
  Oi = Os;
  Ci = Os * mix(dark, Cs, check) * (Ka * ambient() + Kd * diffuse(Nf));
}
