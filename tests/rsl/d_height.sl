displacement d_height(float Km = .15, freq = 6; output varying float height = 0;)
{
    height = Km * float noise(freq * transform("shader", P));
    point Pobj = transform("object", P);
    normal Nobj = normalize(ntransform("object", N));
    P = transform("object", "current", Pobj + height * Nobj);
    N = normalize(calculatenormal(P));
}
