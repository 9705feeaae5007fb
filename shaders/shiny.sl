#include "reflections.h"

/* Plastic that mirrors the scene. */
surface shiny(float Ka = 1; float Kd = .5; float Ks = 1; float Kr = .5; float roughness = .05;
              color specularcolor = 1; color envcolor = 0; string envname = ""; string envspace = "world";)
{
    normal Nf = faceforward(normalize(N), I);
    vector In = normalize(I);
    Oi = Os;
    Ci = 0;
    if (isshadowray() == 0) {
        color env = 0;
        if (Kr > 1e-4)
            env = reflected(P, reflect(In, Nf), envname, envspace, envcolor);
        Ci = Os * (Cs * (Ka * ambient() + Kd * diffuse(Nf)) +
                   specularcolor * (Ks * specular(Nf, -In, roughness) + Kr * env));
    }
}
