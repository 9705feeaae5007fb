surface strings(string mode = "checks/blue"; float freq = 6;)
{
    string kind = mode, tag;
    uniform float isblue = match("blue$", mode);
    tag = concat("mode:", kind, "=", format("%f", freq));
    color c = 1;
    if (match("^checks", mode) != 0) {
        float a = mod(floor(s * freq) + floor(t * freq), 2);
        c = mix(color 1, isblue != 0 ? color (0, 0, 1) : color (1, 0, 0), a);
    }
    string renderer = ""; float v[4];
    if (rendererinfo("renderer", renderer) != 1) c = color (1, 0, 1);
    string sh = shadername();
    if (sh != "strings") c = color (1, 0, 1);
    if (match("mode:.*=6", tag) == 0) c = color (1, 1, 0);
    Oi = Os; Ci = Oi * c * (.2 + .8 * diffuse(faceforward(normalize(N), I)));
}
