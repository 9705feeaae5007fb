color subsurfaceSkin(vector Vf; normal Nn; color skinColor; float eta, thickness)
{
    extern point P;
    float singleScatter(vector inv, outv; normal n; float e, g, albedo, thick) {
        float win = abs(inv . n), wout = abs(outv . n);
        float c2 = max(0, 1 - g * g) / pow(max(1e-3, 1 + g * g - 2 * g * (inv . outv)), 1.5);
        return albedo * c2 * (1 - exp(-(1 / max(win, .05) + 1 / max(wout, .05)) * thick)) / (4 * PI);
    }
    float Kr, Kt, Kr2, Kt2; vector R, T, R2, T2; color C = 0; vector H;
    fresnel(-Vf, Nn, 1 / eta, Kr, Kt, R, T);
    illuminance (P, Nn, PI / 2) {
        vector Ln = normalize(L);
        H = normalize(Ln + Vf);
        if (H . Nn > 0) Kr = Kr * smoothstep(0, .5, H . Nn); else Kr = 0;
        fresnel(-Ln, Nn, 1 / eta, Kr2, Kt2, R2, T2);
        C += skinColor * Cl * (Ln . Nn) * Kt * Kt2 * (singleScatter(T2, T, Nn, eta, .8, .8, thickness) + singleScatter(T2, T, Nn, eta, .3, .5, thickness) + singleScatter(T2, T, Nn, eta, 0, .4, thickness)) * 4 + .3 * skinColor * Cl * (Ln . Nn);
    }
    return C;
}
surface skinlike(color skin = color (.85, .55, .45); float eta = 1.3, thickness = 1;)
{
    normal Nf = faceforward(normalize(N), I);
    Oi = Os; Ci = Oi * (.1 * skin + subsurfaceSkin(-normalize(I), Nf, skin, eta, thickness));
}
