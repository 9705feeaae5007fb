/* 1980s style: normals are points, no faceforward of normals */
surface rc_cmarble(float Ka = 1, Kd = .5, Ks = .5, roughness = .1; color specularcolor = 1; float veining = 3;)
{
    point Nf, V, PP;
    float i, turb, freq;
    color Ct;
    Nf = faceforward(normalize(N), I);
    V = -normalize(I);
    PP = transform("shader", P) * veining;
    turb = 0; freq = 1;
    for (i = 0; i < 6; i += 1) {
        turb += 1 / freq * abs(.5 - noise(4 * freq * PP));
        freq *= 2;
    }
    Ct = spline(sin(8 * zcomp(PP) + 12 * turb) * .5 + .5,
        color (.25, .2, .3), color (.25, .2, .3), color (.4, .35, .5), color (.7, .65, .7), color (.9, .88, .9), color (1, 1, 1), color (1, 1, 1));
    Oi = Os;
    Ci = Os * (Ct * (Ka * ambient() + Kd * diffuse(Nf)) + specularcolor * Ks * specular(Nf, V, roughness));
}
