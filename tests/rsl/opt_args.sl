surface opt_args(string map = ""; float freq = 4;)
{
    float lo = filterstep(.5, mod(s * freq, 1)), a4 = filterstep(.3, s, t, "filter", "triangle", "width", 2);
    float m = min(s, t, .5, u), M = max(s, t, .2), sp = spline("linear", s, 0, 0, 1, .3, 1, 1);
    float ss = spline("solvecatmull-rom", .5, 0, 0, .3, 1, 1);
    color n3 = color noise(s * 8, t * 8), pn = color pnoise(s * 8, t * 8, 4, 4), cn = color cellnoise(s * 8, t * 8);
    float r = random(), at = atan(t - .5, s - .5), l2 = log(8, 2);
    vector rot = vector rotate(point N, .5, point (0, 0, 0), point (0, 0, 1));
    float pl = ptlined(point (0, 0, 0), point (0, 0, 1), transform("shader", P));
    color c = mix(n3, pn, lo) * .5 + cn * .3 + .05 * color (r, m, M) + .1 * sp;
    if (abs(l2 - 3) > 1e-4) c = color (1, 0, 1);
    c *= .7 + .3 * sin(at * 6);
    Oi = Os; Ci = Oi * c * (.3 + .7 * diffuse(faceforward(normalize(N), I))) + 0 * (ss + pl + a4 + length(rot));
}
