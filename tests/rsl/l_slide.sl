light l_slide(float intensity = 1; string slidename = ""; point from = point "shader" (0, 0, 0), to = point "shader" (0, 0, 1); point up = point "shader" (0, 1, 0); float fov = PI / 4; output uniform float __nonspecular = 1;)
{
    vector relT = vector (to - from); vector relU = up ^ relT; vector relV = relT ^ relU;
    relU = normalize(relU); relV = normalize(relV); relT = normalize(relT);
    float spread = 1 / tan(fov / 2);
    illuminate (from, relT, fov) {
        float Pt = L . relT, Pu = (L . relU) * spread / Pt, Pv = (L . relV) * spread / Pt;
        color c;
        if (slidename != "") c = color texture(slidename, .5 + .5 * Pu, .5 - .5 * Pv);
        else c = mod(floor(4 * Pu) + floor(4 * Pv), 2) < 1 ? color (1, .8, .4) : color (.2, .3, .9);
        Cl = intensity * c / (L . L);
    }
}
