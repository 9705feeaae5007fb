#include "patterns_old.h"
surface brickbump(float brickwidth = .25, brickheight = .08, mortar = .01; color brickcolor = color (.6, .1, .1), mortarcolor = color (.6, .6, .6); float Nf_on = 1;)
{
#define BMWIDTH (brickwidth + mortar)
#define BMHEIGHT (brickheight + mortar)
#define MWF (mortar * 0.5 / BMWIDTH)
#define MHF (mortar * 0.5 / BMHEIGHT)
    float ss, tt, sbrick, tbrick, w, h, sbump, tbump, stbump;
    ss = s / BMWIDTH; tt = t / BMHEIGHT;
    if (mod(tt * 0.5, 1) > 0.5) ss += 0.5;
    sbrick = floor(ss); tbrick = floor(tt);
    ss -= sbrick; tt -= tbrick;
    w = step(MWF, ss) - step(1 - MWF, ss);
    h = step(MHF, tt) - step(1 - MHF, tt);
    sbump = smoothstep(0, MWF, ss) - smoothstep(1 - MWF, 1, ss);
    tbump = smoothstep(0, MHF, tt) - smoothstep(1 - MHF, 1, tt);
    stbump = sbump * tbump;
    normal Nf = normalize(N);
    if (Nf_on == 1) Nf = normalize(calculatenormal(P + normalize(N) * stbump * .02));
    Nf = faceforward(Nf, I);
    color Ct = mix(mortarcolor, brickcolor * (.8 + .4 * cellnoise(sbrick, tbrick)), w * h);
    Oi = Os; Ci = Oi * Ct * (.2 * ambient() + .9 * diffuse(Nf));
}
