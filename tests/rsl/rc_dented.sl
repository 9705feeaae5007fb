displacement rc_dented(float Km = 0.2; )
{
    float size = 1, magnitude = 0, i;
    point P2 = transform("shader", P);
    for (i = 0; i < 6.0; i += 1.0) {
        magnitude += abs(.5 - noise(P2 * size)) / size;
        size *= 2.0;
    }
    P -= normalize(N) * (magnitude * magnitude * magnitude) * Km * 10;
    N = calculatenormal(P);
}
