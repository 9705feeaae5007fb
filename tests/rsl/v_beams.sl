volume v_beams(float opacdensity = .3, lightdensity = .3; float integstart = 0, integend = 20, stepsize = .4; color scatter = 1; float freq = 2;)
{
    float density(point p) { return .5 + .7 * (float noise(p * freq) - .5); }
    color lightat(point p)
    {
        color li = 0;
        illuminance (p) { li += Cl; }
        return li;
    }
    point Worigin = P - I;
    vector IN = normalize(vector I);
    color Cv = 0, Ov = 0;
    uniform float maxsteps = 60;
    float tot = min(length(I), integend);
    float d = integstart + stepsize * random();
    float end = tot - 1e-4;
    float ss = min(stepsize, end - d);
    color last = lightat(Worigin + d * IN);
    float n = 0;
    while (d < end && n < maxsteps) {
        d += ss; n += 1;
        color li = lightat(Worigin + d * IN);
        float dens = density(transform("world", Worigin + d * IN));
        color dtau = dens * ss * (lightdensity * (li + last) / 2);
        Cv += dtau * (1 - Ov);
        Ov += (1 - Ov) * (1 - color exp(-opacdensity * ss * dens));
        ss = max(min(stepsize, end - d), .05);
        last = li;
    }
    Ci = Cv + (1 - Ov) * Ci;
    Oi = Ov + (1 - Ov) * Oi;
}
