/* Metal that mirrors an environment map, or the scene when texturename is "raytrace". */
surface shinymetal(float Ka = 1; float Ks = 1; float Kr = 1; float roughness = .1; string texturename = "";)
{
    normal Nf = faceforward(normalize(N), I);
    vector V = normalize(I);
    vector D = reflect(V, Nf);
    color env = 0;
    if (texturename == "raytrace")
        env = trace(P, D);
    else if (texturename != "")
        env = color environment(texturename, vtransform("world", D));
    Oi = Os;
    Ci = Os * Cs * (Ka * ambient() + Ks * specular(Nf, -V, roughness) + Kr * env);
}
