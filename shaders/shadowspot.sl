/* spotlight with a shadow map; the map "raytrace" asks for rays. */
light shadowspot(float intensity = 1; color lightcolor = 1; point from = point "shader" (0, 0, 0);
                 point to = point "shader" (0, 0, 1); float coneangle = radians(30);
                 float conedeltaangle = radians(5); float beamdistribution = 2; string shadowname = "";
                 float samples = 16; float blur = 0.01; float bias = -1;)
{
    uniform vector axis = normalize(to - from);
    uniform float outer = cos(coneangle);
    uniform float inner = cos(coneangle - conedeltaangle);
    illuminate (from, axis, coneangle) {
        float c = (L . axis) / length(L);
        color Cspot = intensity * lightcolor * (pow(c, beamdistribution) / (L . L) * smoothstep(outer, inner, c));
        if (shadowname == "raytrace")
            Cspot *= visibility(Ps, from);
        else if (shadowname != "")
            Cspot *= 1 - float shadow(shadowname, Ps, "samples", samples, "blur", blur, "bias", bias);
        Cl = Cspot;
    }
}
