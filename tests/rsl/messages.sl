surface messages(float Kd = .9;)
{
    float mag = 0, km = 0;
    varying float bumpy_height = 0;
    color c = Cs;
    if (displacement("height", bumpy_height) == 1) c = mix(color (.1, .1, .5), color (1, .9, .6), smoothstep(0, .2, bumpy_height));
    string label = "none";
    uniform float sr = 0; uniform float res[3];
    attribute("ShadingRate", sr);
    option("Format", res);
    if (sr <= 0 || res[0] < 1) c = color (1, 0, 1);
    normal Nf = faceforward(normalize(N), I);
    color sum = 0;
    illuminance (P, Nf, PI / 2) {
        float warm = 0; color tintc = 1;
        lightsource("__warmth", warm);
        sum += Cl * (normalize(L) . Nf) * mix(color 1, color (1, .6, .3), warm);
    }
    Oi = Os; Ci = Oi * c * (.15 + Kd * sum);
}
