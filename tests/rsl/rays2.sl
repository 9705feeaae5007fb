surface rays2(float Kr = .6; string envmap = "raytrace";)
{
    normal Nf = faceforward(normalize(N), I);
    vector R = reflect(normalize(I), Nf);
    uniform string type = ""; uniform float depth = 0;
    rayinfo("type", type); rayinfo("depth", depth);
    color env = color environment(envmap, vtransform("world", R));
    color tr = transmission(P, P + 2 * vector "world" (0, 1, 0));
    color ind = indirectdiffuse(P, Nf, 4);
    Oi = Os;
    Ci = Cs * (.2 + .5 * diffuse(Nf)) * tr + Kr * env + .1 * ind;
    if (type != "camera" && depth == 0) Ci = color (1, 0, 1);
}
