displacement d_bands(float depth = .08; string space = "shader"; float truedisp = 1;)
{
    vector NN = normalize(N);
    float mag = length(vtransform(space, vector NN)); 
    float amp = depth / mag * smoothstep(.3, .7, .5 + .5 * sin(40 * v));
    if (truedisp == 1) { P += amp * NN; N = normalize(calculatenormal(P)); }
    else { N = normalize(calculatenormal(P + amp * NN)); }
    N += 0;
}
