void voronoi_f1f2_3d(point P; float jitter; output float f1; output point pos1; output float f2; output point pos2;)
{
    point thiscell = point (floor(xcomp(P)) + .5, floor(ycomp(P)) + .5, floor(zcomp(P)) + .5);
    f1 = f2 = 1000;
    uniform float i, j, k;
    for (i = -1; i <= 1; i += 1) {
        for (j = -1; j <= 1; j += 1) {
            for (k = -1; k <= 1; k += 1) {
                point testcell = thiscell + vector (i, j, k);
                point pos = testcell + jitter * (vector cellnoise(testcell) - .5);
                vector offset = pos - P;
                float dist = offset . offset;
                if (dist < f1) { f2 = f1; pos2 = pos1; f1 = dist; pos1 = pos; }
                else if (dist < f2) { f2 = dist; pos2 = pos; }
            }
        }
    }
    f1 = sqrt(f1); f2 = sqrt(f2);
}
surface arman_worley(float Ka = .4, Kd = .8, freq = 5; output varying float cell = 0;)
{
    float f1, f2; point p1, p2;
    voronoi_f1f2_3d(freq * transform("shader", P), 1, f1, p1, f2, p2);
    float scalefactor = distance(p1, p2) / (distance(p1, transform("shader", P) * freq) + distance(p2, transform("shader", P) * freq));
    float edge = step(.07 * scalefactor, f2 - f1);
    cell = cellnoise(p1);
    color c = color "hsv" (cell, .7, .9);
    normal Nf = faceforward(normalize(N), I);
    Oi = Os; Ci = Os * c * (.3 + .7 * edge) * (Ka * ambient() + Kd * diffuse(Nf));
}
