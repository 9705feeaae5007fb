/* What an object without a Surface gets: brighter where it faces the eye, independent of all lights. */
surface defaultsurface(float Kd = .8; float Ka = .2;)
{
    float d = normalize(I) . normalize(N);
    Oi = Os;
    Ci = Os * Cs * (Ka + Kd * d * d);
}
