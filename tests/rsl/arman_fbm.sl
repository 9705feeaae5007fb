#include "patterns_old.h"
float fBm(point p; float filtwidth; uniform float maxoctaves, lacunarity, gain)
{
    uniform float i;
    uniform float amp = 1;
    varying point pp = p;
    varying float sum = 0;
    varying float fw = filtwidth;
    for (i = 0; i < maxoctaves && fw < 1.0; i += 1) {
        sum += amp * (1 - smoothstep(.2, .6, fw)) * snoise(pp);
        amp *= gain; pp *= lacunarity; fw *= lacunarity;
    }
    return sum;
}
vector vfBm(point p; float filtwidth; uniform float maxoctaves, lacunarity, gain)
{
    uniform float i; uniform float amp = 1;
    varying point pp = p; varying vector sum = 0;
    for (i = 0; i < maxoctaves; i += 1) {
        sum += amp * (2 * vector noise(pp) - 1);
        amp *= gain; pp *= lacunarity;
    }
    return sum;
}
surface arman_fbm(float Ka = .4, Kd = .8, octaves = 7, lacunarity = 2, gain = .5, freq = 3;)
{
    point Pshad = freq * transform("shader", P);
    float dPshad = filterwidthp(Pshad);
    vector disp = vfBm(Pshad, dPshad, 3, 2, .5);
    float f = fBm(Pshad + .5 * disp, dPshad, octaves, lacunarity, gain);
    color sky = mix(color (.15, .3, .6), color (1, 1, 1), smoothstep(-.2, .6, f));
    normal Nf = faceforward(normalize(N), I);
    Oi = Os; Ci = Os * sky * (Ka * ambient() + Kd * diffuse(Nf));
}
