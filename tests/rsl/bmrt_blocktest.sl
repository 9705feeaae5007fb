/* isshadowray, raylevel, rayhittest, fulltrace as BMRT had them */
surface bmrt_blocktest(float Kd = .8, Ka = .2;)
{
    normal Nf = faceforward(normalize(N), I);
    if (isshadowray() == 1) { Ci = 0; Oi = .5; }
    else {
        color c = Cs * (Ka * ambient() + Kd * diffuse(Nf));
        point Ph; vector Nh;
        float d = rayhittest(P, reflect(normalize(I), Nf), Ph, Nh);
        if (raylevel() < 2 && d < 1e10) {
            color hitc; float hd; point Pmiss, Phit; vector Rmiss, Nhit;
            fulltrace(P, reflect(normalize(I), Nf), hitc, hd, Phit, Nhit, Pmiss, Rmiss);
            c += .3 * hitc;
        }
        Ci = c * visibility(P, P + Nf * .5); Oi = Os; Ci *= Oi;
    }
}
