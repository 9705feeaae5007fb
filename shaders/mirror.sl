#include "reflections.h"

/* A tinted mirror. What it reflects beyond the scene is the environment map `envname` times envcolor, or envcolor
   alone. */
surface mirror(float Ka = 0; float Ks = 0; float Kr = 1; float roughness = .05; color envcolor = 0;
               string envname = ""; string envspace = "world";)
{
    normal Nn = normalize(N);
    vector In = normalize(I);
    normal Nf = faceforward(Nn, In);
    Oi = Os;
    Ci = 0;
    if (isshadowray() == 0) {
        color env = 0;
        if (Kr > 1e-4)
            env = reflected(P, reflect(In, Nf), envname, envspace, envcolor);
        Ci = Os * Cs * (Ka * ambient() + Ks * specular(Nf, -In, roughness) + Kr * env);
    }
}
