#include "patterns_old.h"
surface hexes(float tileradius = .06, tilespace = .01; color tilecolor = color (.55, 0, 0), spacecolor = .4;)
{
    float tilewidth = tileradius * 1.7320508, tt, ss, ttile, stile, x, y, mo;
    tt = mod(t, tileradius * 1.5); ttile = floor(t / (tileradius * 1.5));
    if (mod(ttile / 2, 1) == .5) ss = s + tilewidth / 2; else ss = s;
    stile = floor(ss / tilewidth); ss = mod(ss, tilewidth);
    mo = 0;
    x = tilewidth / 2 - abs(ss - tilewidth / 2);
    y = tileradius * 1.5 / 2 - abs(tt - tileradius * .75);
    mo = 1 - smoothstep(tilespace / 2, tilespace, min(x, y + tileradius * .2 * (x / tilewidth)));
    color c = mix(tilecolor * (.6 + .8 * cellnoise(stile, ttile)), spacecolor, mo);
    Oi = Os; Ci = Oi * c * (.2 + .8 * diffuse(faceforward(normalize(N), I)));
}
