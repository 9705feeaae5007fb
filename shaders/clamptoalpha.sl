/* Colors above the coverage are cut, for compositing programs that expect it. */
imager clamptoalpha()
{
    Ci = clamp(Ci, color 0, Oi);
}
