/* Does nothing: the surface is black. */
surface null()
{
}
