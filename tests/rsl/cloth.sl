#include "patterns_old.h"
surface cloth(float freq = 40, depthv = .02; color warp = color (.7, .2, .3), weft = color (.2, .3, .7);)
{
    float ss = s * freq, tt = t * freq;
    float wf = filterwidth(ss);
    float fade = 1 - smoothstep(.3, .7, wf);
    float a = mod(floor(ss) + floor(tt), 2);
    float hump = a == 0 ? sin(PI * mod(ss, 1)) : sin(PI * mod(tt, 1));
    vector U = normalize(dPdu), V = normalize(dPdv);
    normal Nb = normalize(N + fade * depthv * 20 * (a == 0 ? U * cos(PI * mod(ss, 1)) : V * cos(PI * mod(tt, 1))));
    Nb = faceforward(Nb, I);
    Oi = Os;
    Ci = Oi * mix(warp, weft, a) * (.3 + .7 * hump) * (.2 + .8 * diffuse(Nb)) + .2 * specular(Nb, -normalize(I), .3);
}
