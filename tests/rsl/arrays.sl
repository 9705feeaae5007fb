surface arrays(float weights[8] = { .1, .2, .3, .4, .5, .6, .7, .8 }; color ramp[4] = { color (1, 0, 0), color (1, 1, 0), color (0, 1, 0), color (0, 0, 1) };)
{
    float w[8]; uniform float i; float total = 0;
    for (i = 0; i < 8; i += 1) { w[i] = weights[7 - i] * noise(i * 3 + 8 * s); total += w[i]; }
    float pick = mod(floor(8 * t + total), 4);
    color c = ramp[pick];
    color sp = spline(t, ramp);
    float f = spline("bspline", s, weights);
    point pts[3] = { point (0, 0, 0), P, P + N };
    pts[1] = mix(pts[0], pts[2], .5);
    c = mix(c, sp, .5) * (.5 + f);
    Oi = Os; Ci = Oi * c * (.3 + .7 * diffuse(faceforward(normalize(N), I))) + 0 * length(vector pts[1]);
}
