surface arman_glass(float Ka = .2, Kd = 0, Ks = .5, Kr = 1, Kt = 1, roughness = .05, eta = 1.5, blur = 0, samples = 1;
    color specularcolor = 1, transmitcolor = color (.9, 1, .9);)
{
    normal Nn = normalize(N);
    normal Nf = faceforward(Nn, I);
    vector V = -normalize(I), IN = normalize(I);
    float kr, kt; vector Rdir, Tdir;
    fresnel(IN, Nf, (I . N) < 0 ? 1 / eta : eta, kr, kt, Rdir, Tdir);
    kt = 1 - kr;
    color refl = 0, refr = 0;
    if (kr * Kr > .001) refl = Kr * kr * color trace(P, Rdir, "samples", samples, "samplecone", blur);
    if (kt * Kt > .001) refr = Kt * kt * trace(P, Tdir);
    Ci = Cs * (Ka * ambient() + Kd * diffuse(Nf)) + specularcolor * (refl + Ks * specular(Nf, V, roughness)) + transmitcolor * refr;
    Oi = 1;
}
