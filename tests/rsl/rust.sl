#include "patterns_old.h"
float turbulence(point P; uniform float octaves; varying float dP)
{
    varying float sum = 0, x; uniform float f = 1, i;
    for (i = 0; i < octaves; i += 1) { sum += abs(snoise(P * f)) / f; f *= 2; }
    return sum;
}
surface rust(uniform float Ka = .3; varying float rustiness = .5; float Kd = .8, Ks = .9, roughness = .1;)
{
    point Ps2 = transform("shader", P) * 4;
    float turb = turbulence(Ps2, 5, 0), r = smoothstep(1 - rustiness, 1.3 - rustiness, turb);
    color metalc = color (.7, .7, .75), rustc = mix(color (.35, .15, .05), color (.6, .3, .1), noise(Ps2 * 6));
    normal Nf = faceforward(normalize(N), I);
    color c1, c2;
    c1 = metalc * (Ka * ambient() + .3 * Kd * diffuse(Nf)) + Ks * specular(Nf, -normalize(I), roughness);
    c2 = rustc * (Ka * ambient() + Kd * diffuse(Nf));
    Oi = Os; Ci = Oi * mix(c1, c2, r);
}
