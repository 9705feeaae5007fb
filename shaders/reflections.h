/* Rays that fall back on an environment.

   reflected(): what comes along the unit direction R to P. Rays that leave the scene, also deeper in the ray tree, see
   the environment map, or the color skycolor without a map. The returned depth of the miss dims it as often as
   surfaces have been met on the way. */
#ifndef REFLECTIONS_H
#define REFLECTIONS_H 1

color skyinto(vector R; string envname; string envspace; color skycolor)
{
    color sky = skycolor;
    if (envname != "")
        sky = skycolor * color environment(envname, vtransform(envspace, R));
    return sky;
}

color reflected(point from; vector R; string envname; string envspace; color skycolor)
{
    color hit = 0;
    float distance = 0;
    point Phit = from;
    vector Nhit = 0;
    point Pmiss = from;
    vector Rmiss = 0;
    float depth = fulltrace(from, R, hit, distance, Phit, Nhit, Pmiss, Rmiss);
    if (depth > 0)
        hit += skyinto(normalize(Rmiss), envname, envspace, skycolor) / depth;
    return hit;
}

#endif
