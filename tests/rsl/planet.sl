#include "patterns_old.h"
#define TWOPI (2 * PI)
#define VLNOISE(Pt, scale) (snoise(vector (Pt) * .5) * (scale))
surface planet(float spectral_exp = .5, lacunarity = 2, octaves = 7, bump_scale = .07, multifractal = 0, dist_scale = .2, offset = 0, sea_level = 0, mtn_scale = .95, lat_scale = .95, nonlinear = 0, purt_scale = .9, map_exp = 0, ice_caps = .9, depth_scale = 1, depth_max = .5, mottle_limit = .75, mottle_scale = 20, mottle_dim = .25, mottle_mag = .02;)
{
    point PP, PtN; normal NN; float chaos, latitude, purt; color Ct = 0; float o, l, a, i, value = 0;
    PP = transform("shader", P);
    NN = normalize(N);
    PtN = PP;
    l = 1; o = 1; a = 0;
    for (i = 0; i < octaves; i += 1) { a += o * snoise(l * PtN); l *= lacunarity; o *= spectral_exp; }
    value = a;
    chaos = a; latitude = abs(zcomp(PtN)); latitude += chaos * .1;
    if (value < sea_level) {
        float depth = depth_scale * (sea_level - value);
        Ct = mix(color (.1, .3, .55), color (0, .05, .25), clamp(depth, 0, depth_max) / depth_max);
    } else {
        Ct = spline(clamp(value * mtn_scale, 0, 1), color (.2, .45, .1), color (.2, .45, .1), color (.4, .4, .15), color (.55, .4, .25), color (.6, .6, .55), color (1, 1, 1), color (1, 1, 1));
    }
    if (latitude > ice_caps) Ct = color (.95, .97, 1);
    Oi = Os; Ci = Oi * Ct * (.1 + .9 * diffuse(faceforward(NN, I)));
}
