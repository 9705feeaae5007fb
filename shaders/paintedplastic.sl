/* Plastic whose color is multiplied by a texture. */
surface paintedplastic(float Ka = 1; float Kd = .5; float Ks = .5; float roughness = .1; color specularcolor = 1;
                       string texturename = "";)
{
    normal Nf = faceforward(normalize(N), I);
    vector V = -normalize(I);
    color paint = 1;
    if (texturename != "")
        paint = color texture(texturename);
    Oi = Os;
    Ci = Os * (Cs * paint * (Ka * ambient() + Kd * diffuse(Nf)) + specularcolor * Ks * specular(Nf, V, roughness));
}
