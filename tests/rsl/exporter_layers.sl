#define ENTERLAYER(o) layer_opac = (o); layer_color = 0;
#define COMPOSITE surface_color = mix(surface_color, layer_color, layer_opac);
#if defined(BMRT) || defined(FRANKENRENDER)
#  define HAVE_RAYS 1
#else
#  define HAVE_RAYS 0
#endif
surface
exporter_layers (
    float Ka = 1.0; float Kd = 0.7; float Ks = 0.4;
    float roughness = 0.15;
    color layer1_color = color(0.8, 0.1, 0.1);
    color layer2_color = color(0.1, 0.5, 0.9);
    string layer1_map = "", layer2_map = "";
    float layer_weights[3] = { 1, .5, .25 };
    color palette[4] = { color(1,0,0), color(0,1,0), color(0,0,1), color(1,1,0) };
    string projections[2] = { "st", "planar" };
    output varying color diffuse_pass = 0;
    output varying color specular_pass = 0;
)
{
    color surface_color = Cs, layer_color; float layer_opac;
    float ss = s, tt = t;
    uniform float i;
    for (i = 0; i < 3; i += 1) {
        if (projections[mod(i, 2)] == "planar") {
            point Pp = transform("shader", P);
            ss = xcomp(Pp); tt = ycomp(Pp);
        } else { ss = s; tt = t; }
        ENTERLAYER(layer_weights[i] * smoothstep(.3, .7, noise(ss * 8 * (i + 1), tt * 8)))
        layer_color = palette[i];
        if (layer1_map != "") layer_color *= color texture(layer1_map, ss, tt);
        COMPOSITE
    }
    normal Nf = faceforward(normalize(N), I);
    diffuse_pass = surface_color * (Ka * ambient() + Kd * diffuse(Nf));
    specular_pass = Ks * specular(Nf, -normalize(I), roughness);
    Oi = Os; Ci = Oi * (diffuse_pass + specular_pass);
}
