/* Light scattered on its way through a cloud: steps along the ray, at each the density and the lights that reach it.
   For Atmosphere, Interior and Exterior. A light whose parameter __foglight is 0 is not seen in the smoke. */
volume smoke(
    float density = 0.2;      /* opacity gathered per unit of length */
    float scatter = 1;        /* share of the light that goes on towards the eye */
    color smokecolor = 1;
    float stepsize = 0.5;
    float maxsteps = 64;
    float turbulence = 0;     /* 0: even; 1: as uneven as noise is */
    float frequency = 1;)
{
    float distance = length(I);
    float steps = clamp(ceil(distance / max(stepsize, 1e-4)), 1, max(1, floor(maxsteps)));
    float ds = distance / steps;
    point origin = P - I;
    color lit = 0;
    color through = 1;
    float k = random();       /* where in its step each point stands */
    float i;
    for (i = 0; i < steps; i += 1) {
        point here = origin + I * ((i + k) / steps);
        float d = density;
        if (turbulence > 0)
            d *= mix(1, 2 * noise(frequency * transform("world", here)), turbulence);
        color arriving = 0;
        illuminance (here) {
            float seen = 1;
            lightsource("__foglight", seen);
            if (seen > 0)
                arriving += Cl;
        }
        color stop = 1 - exp(-d * ds);
        lit += through * stop * scatter * smokecolor * arriving;
        through *= 1 - stop;
    }
    Ci = lit + through * Ci;
    Oi = 1 - through * (1 - Oi);
}
