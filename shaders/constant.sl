/* The object's own color, whatever the light. */
surface constant()
{
    Oi = Os;
    Ci = Os * Cs;
}
