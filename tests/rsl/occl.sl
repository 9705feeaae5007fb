surface occl(float samples = 16, maxdist = 10; output varying color bent = 0;)
{
    normal Nf = faceforward(normalize(N), I);
    float occ = occlusion(P, Nf, samples, "maxdist", maxdist, "coneangle", PI / 2);
    float hits = 0, total = 0; color gathered = 0; float rl = 0; vector rd = 0;
    gather ("illuminance", P, Nf, PI / 3, 4, "surface:Ci", gathered, "ray:length", rl, "ray:direction", rd) { hits += 1; bent += gathered; }
    else { total += 1; }
    Oi = 1; Ci = Cs * (1 - occ) * (.6 + .4 * total / (total + hits)) + .1 * bent;
}
