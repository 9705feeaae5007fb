/* Wood by rings.c, cracked glaze by crackle.cpp: the one is called point by point, the other for whole batches. */
surface carved(float Ka = 0.2, Kd = 0.8, frequency = 14, turbulence = 0.35, glaze = 0.5; string wood = "oak";) {
  normal Nf = faceforward(normalize(N), I);
  point PP = transform("shader", P);
  color base;
  if (t > glaze) {
    base = palette(wood, rings(PP, frequency, turbulence));
  } else {
    color cell;
    float edge = crackle(6 * PP, 0.9, cell);
    base = mix(color(0.05, 0.04, 0.03), mix(color(0.75, 0.8, 0.78), cell, 0.25), smoothstep(0.02, 0.08, edge));
  }
  Oi = Os;
  Ci = Os * base * (Ka * ambient() + Kd * diffuse(Nf));
}
