#define SQRT2(x) ((x) * (x))
surface hair(float Ka = .3, Kd = .6, Ks = .5, roughness = .15; color rootcolor = color (.1, .05, .02), tipcolor = color (.8, .6, .3);)
{
    vector T = normalize(dPdv), V = -normalize(I);
    color Cspec = 0, Cdiff = 0;
    float cosang;
    illuminance (P) {
        cosang = cos(abs(acos(T . normalize(L)) - acos(-T . V)));
        Cspec += Cl * v * pow(clamp(cosang, 0, 1), 1 / roughness);
        Cdiff += Cl * v * sqrt(max(0, 1 - SQRT2(T . normalize(L))));
    }
    Oi = Os; Ci = Oi * (mix(rootcolor, tipcolor, v) * (Ka * ambient() + Kd * Cdiff) + Ks * Cspec);
}
