#include "patterns_old.h"
float filteredpulsetrain(float edge, period, x, dx)
{
    float w = dx / period;
    float x0 = x / period - w / 2;
    float x1 = x0 + w;
    float nedge = edge / period;
    float integral(float t) { extern float nedge; return ((1 - nedge) * floor(t) + max(0, t - floor(t) - nedge)); }
    float result;
    if (x0 == x1) result = (mod(x0, 1) < nedge) ? 0 : 1;
    else {
        result = (integral(x1) - integral(x0)) / w;
    }
    return result;
}
surface arman_aastripe(float Ka = .3, Kd = .8; color stripecolor = color (.9, .2, .1); float nstripes = 12;)
{
    float ss = s * nstripes + .3 * t;
    float d = filterwidth(ss);
    normal Nf = faceforward(normalize(N), I);
    Oi = Os;
    Ci = Os * mix(Cs, stripecolor, filteredpulsetrain(.5, 1, ss, d)) * (Ka * ambient() + Kd * diffuse(Nf));
}
