/* Fades with the depth between two distances, given as fractions of the clipping range. */
volume depthcue(float mindistance = 0; float maxdistance = 1; color background = 0;)
{
    float d = clamp((depth(P) - mindistance) / (maxdistance - mindistance), 0, 1);
    Ci = mix(Ci, background, d);
    Oi = mix(Oi, color 1, d);
}
