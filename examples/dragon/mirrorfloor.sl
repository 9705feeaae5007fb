/* Lit floor that mirrors what stands on it. */
surface mirrorfloor(float Ka = 0.3, Kd = 0.6, Kr = 0.35; color background = color(0.10, 0.12, 0.16)) {
  normal Nf = faceforward(normalize(N), I);
  vector R = reflect(normalize(I), Nf);
  color hitcolor = 0;
  float hitdist = 0;
  point Phit = P, Pmiss = P;
  vector Nhit = Nf, Rmiss = R;
  fulltrace(P, R, hitcolor, hitdist, Phit, Nhit, Pmiss, Rmiss);
  if (hitdist > 1.0e10) hitcolor = background;
  Oi = Os;
  Ci = Os * (Cs * (Ka * ambient() + Kd * diffuse(Nf)) + Kr * hitcolor);
}
