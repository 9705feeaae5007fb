/* Displacement by a texture's first channel. `amplitude` and `Km` are two names of one thing. */
displacement bumpy(float amplitude = 1; float Km = 1; string texturename = "";)
{
    float height = 0;
    if (texturename != "")
        height = amplitude * Km * float texture(texturename);
    P += height * normalize(N);
    N = calculatenormal(P);
}
