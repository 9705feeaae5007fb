surface textured(string map = "", bumpmap = ""; float Kd = .9; float rep = 3;)
{
    float ss = mod(s * rep, 1), tt = mod(t * rep, 1);
    color c = Cs; float a = 1;
    if (map != "") {
        c = texture(map, s * rep, t * rep, "filter", "gaussian", "swidth", 1.2, "twidth", 1.2);
        a = float texture(map[3], s * rep, t * rep, "fill", 1);
        uniform float res[2] = { 0, 0 };
        if (textureinfo(map, "resolution", res) == 0 || res[0] < 1) c = color (1, 0, 1);
        float bl = texture(map[0], s, t, "blur", .1);
        c = mix(c, color bl, .2);
    }
    normal Nf = faceforward(normalize(N), I);
    Oi = Os * a; Ci = Oi * c * (.2 + Kd * diffuse(Nf));
}
