light l_area(float intensity = 1; color lightcolor = 1; float falloff = 2; string __category = "area,soft";)
{
    illuminate (P, N, PI / 2) {
        Cl = intensity * lightcolor * pow(1 / length(L), falloff) * max(0, normalize(L) . normalize(N));
    }
}
