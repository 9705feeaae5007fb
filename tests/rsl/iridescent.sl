surface iridescent(float thickness = 3, Ks = .6;)
{
    normal Nf = faceforward(normalize(N), I);
    vector V = -normalize(I);
    color thin(float c) {
        color r = 0; uniform float k;
        for (k = 0; k < 3; k += 1) {
            float phase = 2 * PI * thickness * c / (.45 + .1 * k);
            setcomp(r, 2 - k, .5 + .5 * cos(phase));
        }
        return r;
    }
    color film = thin(V . Nf);
    color hsv = ctransform("rgb", "hsv", film);
    hsv = color (comp(hsv, 0), clamp(comp(hsv, 1) * 1.3, 0, 1), comp(hsv, 2));
    film = ctransform("hsv", "rgb", hsv);
    Oi = Os; Ci = Oi * (film * (.2 + .8 * diffuse(Nf)) + Ks * phong(Nf, V, 40));
}
