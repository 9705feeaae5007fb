light l_window(float intensity = 1; color lightcolor = 1; point from = point "camera" (0, 0, 0); vector dir = vector "world" (0, -1, .2);)
{
    uniform vector A = normalize(dir);
    solar (A, 0) {
        point Pw = transform("world", Ps);
        float bars = step(.15, mod(xcomp(Pw) * 2, 1)) * step(.15, mod(zcomp(Pw) * 2, 1));
        Cl = intensity * lightcolor * bars;
    }
}
