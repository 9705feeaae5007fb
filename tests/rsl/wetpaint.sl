surface wetpaint(float coat = .7; color base = color (.1, .5, .2); varying normal bentN = 0; varying point Pref = 0;)
{
    normal Nn = normalize(N);
    normal Nf = Nn * sign(-Nn . I);
    vector V = -normalize(I);
    float F = .04 + .96 * pow(1 - max(0, V . Nf), 5);
    color diff = 0, spec = 0;
    illuminance ("-special", P, Nf, PI / 2) {
        vector H = normalize(normalize(L) + V);
        color Lc = Cl;
        diff += Lc * max(0, Nf . normalize(L));
        spec += Lc * pow(max(0, Nf . H), 80) * F * 8;
    }
    point q = Pref == point 0 ? transform("object", P) : Pref;
    float drip = smoothstep(.45, .55, noise(q * vector (6, 1.5, 6)));
    Oi = Os; Ci = Oi * (mix(base, base * .5, drip) * (.1 + diff) + coat * spec);
}
