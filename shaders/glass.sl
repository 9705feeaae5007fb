#include "reflections.h"

/* Clear glass: Fresnel reflection and real refraction. Needs outward normals. Shadow rays pass, dimmed by
   transmitcolor and the reflected part; all other rays are answered by the rays that this shader sends itself. */
surface glass(float Ka = 0; float Kd = 0; float Ks = 1; float Kr = 1; float Kt = 1; float ior = 1.5;
              float roughness = .02; color transmitcolor = 1; color envcolor = 0; string envname = "";
              string envspace = "world";)
{
    normal Nn = normalize(N);
    vector In = normalize(I);
    normal Nf = faceforward(Nn, In);
    float eta = (In . Nn) < 0 ? 1 / ior : ior;
    float kr = 0, kt = 0;
    vector R = 0, T = 0;
    fresnel(In, Nf, eta, kr, kt, R, T);
    kt = 1 - kr;
    if (isshadowray() == 1) {
        Oi = Os * (1 - Kt * kt * transmitcolor);
        Ci = 0;
    } else {
        color through = 0, back = 0;
        if (Kt * kt > 1e-3)
            through = reflected(P, T, envname, envspace, envcolor);
        if (Kr * kr > 1e-3)
            back = reflected(P, R, envname, envspace, envcolor);
        Oi = Os;
        Ci = Os * (Cs * (Ka * ambient() + Kd * diffuse(Nf)) + Ks * specular(Nf, -In, roughness) +
                   Kr * kr * back + Kt * kt * transmitcolor * through);
    }
}
