float true_cond(float j) { return j < 6; }
surface deep_nest(float n = 5;)
{
    float count = 0, i, j;
    color acc = 0;
    float tri(float x) { return abs(mod(x, 2) - 1); }
    for (i = 0; i < n; i += 1) {
        j = 0;
        while (true_cond(j)) {
            j += 1;
            if (mod(i + j, 3) == 0) continue;
            if (j > 4 * s + 2) break;
            if (i > 3 && t > .5) break 2;
            acc += color (tri(s * i), tri(t * j), .1) / 8;
            count += 1;
        }
    }
    Oi = Os; Ci = Oi * acc * (.3 + diffuse(faceforward(normalize(N), I)));
}
