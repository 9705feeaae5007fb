/* Light from the side of a surface that its normals point to (AreaLightSource). The renderer moves P and N over
   the surface. */
light arealight(float intensity = 1; color lightcolor = 1;)
{
    illuminate (P, N, PI / 2)
        Cl = intensity * lightcolor / (L . L);
}
