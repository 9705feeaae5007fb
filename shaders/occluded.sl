/* Matte under an even sky: darker where other surfaces are near. */
surface occluded(float Ka = 1, Kd = 0; float samples = 64; float maxdist = 1e30; float coneangle = PI / 2;)
{
    normal n = normalize(faceforward(N, I));
    color arriving = 0;
    if (Ka > 0)
        arriving += Ka * (1 - occlusion(P, n, samples, "maxdist", maxdist, "coneangle", coneangle));
    if (Kd > 0)
        arriving += Kd * diffuse(n);
    Oi = Os;
    Ci = Os * Cs * arriving;
}
