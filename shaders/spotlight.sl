/* A cone of light with a soft edge. Angles are half angles in radians. */
light spotlight(float intensity = 1; color lightcolor = 1; point from = point "shader" (0, 0, 0);
                point to = point "shader" (0, 0, 1); float coneangle = radians(30);
                float conedeltaangle = radians(5); float beamdistribution = 2;)
{
    uniform vector axis = normalize(to - from);
    uniform float outer = cos(coneangle);
    uniform float inner = cos(coneangle - conedeltaangle);
    illuminate (from, axis, coneangle) {
        float c = (L . axis) / length(L);
        float strength = pow(c, beamdistribution) / (L . L) * smoothstep(outer, inner, c);
        Cl = intensity * lightcolor * strength;
    }
}
