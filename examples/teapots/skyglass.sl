/* Clear glass: Fresnel-weighted reflection and refraction through fulltrace. Rays of the tree that leave the scene bring
   the sky along, dimmed by their depth, as the BMRT documentation suggests. */
#include "sky.h"

color seen(point from; vector dir) {
  color hitcolor = 0;
  float hitdist = 0;
  point Phit = from, Pmiss = from;
  vector Nhit = dir, Rmiss = dir;
  float missed = fulltrace(from, dir, hitcolor, hitdist, Phit, Nhit, Pmiss, Rmiss);
  if (hitdist > 1.0e10) hitcolor = sky(vtransform("world", dir));
  return hitcolor;
}

surface skyglass(float ior = 1.5; color tint = color(0.90, 0.97, 0.94); float Ks = 0.6, roughness = 0.02) {
  vector V = normalize(I);
  normal Nn = normalize(N);
  float entering = (V.Nn < 0) ? 1 : 0;
  normal Nf = faceforward(Nn, V, Nn);
  float eta = (entering > 0) ? 1 / ior : ior;
  float kr, kt;
  vector R, T;
  fresnel(V, Nf, eta, kr, kt, R, T);
  kt = 1 - kr;
  if (isshadowray() > 0) {
    Ci = 0;
    Oi = 1 - kt * tint;
  } else {
    color c = 0;
    if (kt > 0.001) c += kt * tint * seen(P, T);
    if (kr > 0.001 && raylevel() < 3) c += kr * seen(P, R);
    Ci = c + Ks * specular(Nf, -V, roughness);
    Oi = 1;
  }
}
