#include "patterns_old.h"
surface rc_screen(float Ka = 1; float Kd = .75; float Ks = .4; float roughness = .1; color specularcolor = 1; float density = .25; float frequency = 20;)
{
    varying point Nf, V;
    if (mod(s * frequency, 1) < density || mod(t * frequency, 1) < density) {
        Nf = faceforward(normalize(N), I);
        V = -normalize(I);
        Oi = 1;
        Ci = Os * (Cs * (Ka * ambient() + Kd * diffuse(Nf)) + specularcolor * Ks * specular(Nf, V, roughness));
    } else {
        Oi = 0; Ci = 0;
    }
}
