light uberish(float intensity = 1; color lightcolor = 1; string lighttype = "spot";
    point from = point "shader" (0, 0, 0); point to = point "shader" (0, 0, 1);
    float cuton = .01, cutoff = 1e6, nearedge = 0, faredge = 0; float falloff = 2, falloffdist = 5, maxintensity = 5;
    float parallelrays = 0; float shearx = 0, sheary = 0; float width = 1, height = 1, wedge = .2, hedge = .2, roundness = 1; float beamdistribution = 0;
    string shadowname = ""; float shadowblur = .01, shadowbias = .01; color shadowcolor = 0;
    output varying float __nondiffuse = 0; output varying float __nonspecular = 0; output float __foglight = 1; output float __warmth = .6;)
{
    float clipSuperellipse(point Q; float a, b, A, B; float roundness;)
    {
        float result;
        float x = abs(xcomp(Q)), y = abs(ycomp(Q));
        if (roundness < 1.0e-6) {
            result = 1 - (1 - smoothstep(a, A, x)) * (1 - smoothstep(b, B, y));
            result = 1 - result;
        } else {
            float re = 2 / roundness;
            float q = a * b * pow(pow(b * x, re) + pow(a * y, re), -1 / re);
            float r = A * B * pow(pow(B * x, re) + pow(A * y, re), -1 / re);
            result = 1 - smoothstep(q, r, 1);
            result = smoothstep(q, r, 1) == 0 ? 1 : result;
        }
        return result;
    }
    float volumecontrib(point P)
    {
        point PL = P; float atten = 1;
        float z = zcomp(PL);
        atten *= smoothstep(cuton - nearedge, cuton, z);
        atten *= 1 - smoothstep(cutoff, cutoff + faredge, z);
        if (falloff != 0 && falloffdist > 0) {
            float PlL = length(vector PL);
            if (PlL > falloffdist) atten *= pow(falloffdist / PlL, falloff);
            else {
                float s = log(1 / maxintensity);
                float beta = -falloff / s;
                atten *= maxintensity * exp(s * pow(PlL / falloffdist, beta));
            }
        }
        return atten;
    }
    vector axis = normalize(to - from);
    uniform float angle = PI / 3;
    illuminate (from, axis, angle) {
        point PL = transform("shader", Ps);
        float atten = volumecontrib(PL);
        point Pflat = PL / max(zcomp(PL), 1e-3) * 1;
        atten *= clipSuperellipse(Pflat, width, height, width + wedge, height + hedge, roundness);
        if (beamdistribution > 0) atten *= pow(normalize(vector PL) . vector "shader" (0, 0, 1), beamdistribution);
        color lcol = lightcolor;
        if (shadowname != "") {
            float sh = float shadow(shadowname, Ps, "blur", shadowblur, "bias", shadowbias);
            lcol = mix(lcol, shadowcolor, sh);
        }
        Cl = intensity * atten * lcol;
        __nondiffuse = 0;
    }
}
