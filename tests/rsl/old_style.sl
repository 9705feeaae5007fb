surface
old_style (
  float  Ka = 1, Kd = 1, Ks = 0; point center = (0, 0, 0); point axis = (0, 0, 1); color mapcolor = (1, .5, .2);
)
{
  point n, VV;
  varying float latitude, longitude;
  n = faceforward (normalize(N), I);
  VV = normalize(-I);
  point p = transform("shader", P) - center;
  longitude = (atan(ycomp(p), xcomp(p)) + PI) / (2 * PI);
  latitude = acos(zcomp(p) / length(p)) / PI;
  color k = (latitude, longitude, .3);
  if (!(mod(longitude * 12, 1) > .9) && latitude != 0) k *= mapcolor;
  Oi = Os;
  Ci = Os * (k * (Ka*ambient() + Kd*diffuse(n)) + Ks*specular(n,VV,.1));
}
