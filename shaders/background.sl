/* A color behind the image. */
imager background(color bgcolor = 1; color background = color (-1, -1, -1);)
{
    /* `background` is the older name of the same parameter. */
    color bg = comp(background, 0) < 0 ? bgcolor : background;
    Ci += (1 - alpha) * bg;
    Oi = 1;
    alpha = 1;
}
