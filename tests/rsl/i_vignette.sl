imager i_vignette(color bg = color (.1, .1, .2);)
{
    uniform float res[3];
    option("Format", res);
    float x = xcomp(P) / res[0] - .5, y = ycomp(P) / res[1] - .5;
    Ci += (1 - alpha) * mix(bg, color 0, 2 * (x * x + y * y));
    Ci *= 1 - x * x - y * y;
    Oi = 1; alpha = 1;
}
