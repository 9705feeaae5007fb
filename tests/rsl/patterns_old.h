#ifndef PATTERNS_OLD_H
#define PATTERNS_OLD_H
#define snoise(x) (2 * noise(x) - 1)
#define snoisexy(x, y) (2 * noise(x, y) - 1)
#define boxstep(a, b, x) (clamp(((x) - (a)) / ((b) - (a)), 0, 1))
#define pulse(a, b, x) (step((a), (x)) - step((b), (x)))
#define MINFILTERWIDTH 1e-7
#define filterwidth(x) max(abs(Du(x) * du) + abs(Dv(x) * dv), MINFILTERWIDTH)
#define filterwidthp(p) max(sqrt(area(p)), MINFILTERWIDTH)
#define blend(a, b, x) ((a) * (1 - (x)) + (b) * (x))
#define whichtile(x, freq) floor((x) * (freq))
#define repeat(x, freq) (mod((x) * (freq), 1.0))
#define odd(x) (mod((x), 2) == 1)
#define even(x) (mod((x), 2) == 0)
#define SQR(A) ((A) * (A))
#define filteredstep(edge, x, w) smoothstep((edge) - (w) / 2, (edge) + (w) / 2, (x))
#endif
