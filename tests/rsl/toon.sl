surface toon(float levels = 4; float outline = .3;)
{
    normal Nf = faceforward(normalize(N), I);
    vector V = -normalize(I);
    color total = 0;
    illuminance ("", P, Nf, PI / 2) {
        float d = normalize(L) . Nf;
        float q = floor(d * levels) / levels;
        if (d < 0) continue;
        total += Cl * q;
    }
    Oi = Os;
    Ci = (V . Nf) < outline ? color 0 : Oi * Cs * (.2 + total);
}
