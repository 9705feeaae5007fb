#include "patterns_old.h"
surface rc_wood(float ringscale = 10; color lightwood = color (.5, .27, .1), darkwood = color (.22, .1, .04);
    float Ka = .3, Kd = .7, Ks = .3, roughness = .2;)
{
    point PP, V; normal NN; color Ct; float y, z, r;
    PP = transform("shader", P);
    PP += noise(PP);
    y = ycomp(PP); z = zcomp(PP);
    r = sqrt(y * y + z * z);
    r *= ringscale;
    r += abs(noise(r));
    r -= floor(r);
    r = smoothstep(0, .8, r) - smoothstep(.83, 1.0, r);
    Ct = mix(lightwood, darkwood, r);
    NN = faceforward(normalize(N), I); V = -normalize(I);
    Oi = Os;
    Ci = Oi * (Ct * (Ka * ambient() + Kd * diffuse(NN)) + (.3 * r + .7) * (Ks * specular(NN, V, roughness)));
}
