/* Mirror: one reflected ray a point; a ray that leaves the scene sees the sky. */
#include "sky.h"

surface chrome(float Kr = 0.9; color tint = color(0.96, 0.97, 1.0)) {
  normal Nf = faceforward(normalize(N), I);
  vector R = reflect(normalize(I), Nf);
  color hitcolor = 0;
  float hitdist = 0;
  point Phit = P, Pmiss = P;
  vector Nhit = Nf, Rmiss = R;
  fulltrace(P, R, hitcolor, hitdist, Phit, Nhit, Pmiss, Rmiss);
  if (hitdist > 1.0e10) hitcolor = sky(vtransform("world", R));
  Oi = Os;
  Ci = Os * tint * Kr * hitcolor;
}
