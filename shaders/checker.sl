/* A matte floor of two colors, in squares of s and t, antialiased by the size of the shading cell. */
surface checker(float Ka = 1; float Kd = 1; float frequency = 8; color darkcolor = color (.2, .2, .2);)
{
    /* One period of the pattern is -1 and 1: its integral is a triangle wave, so the box filter is exact. */
    float wave(float x) { return abs(mod(x, 2) - 1); }
    float filtered(float x; float w) { return (wave(x + w / 2) - wave(x - w / 2)) / w; }

    float ss = s * frequency, tt = t * frequency;
    float ws = max(abs(Du(ss) * du) + abs(Dv(ss) * dv), 1e-6);
    float wt = max(abs(Du(tt) * du) + abs(Dv(tt) * dv), 1e-6);
    float board = 0.5 - 0.5 * filtered(ss, ws) * filtered(tt, wt);
    normal Nf = faceforward(normalize(N), I);
    Oi = Os;
    Ci = Os * mix(Cs, darkcolor, board) * (Ka * ambient() + Kd * diffuse(Nf));
}
