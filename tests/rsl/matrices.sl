surface matrices(float angle = .6; matrix M0 = matrix "world" 1;)
{
    matrix M = rotate(matrix 1, angle, vector (0, 0, 1));
    M = translate(M, vector (.2, .1, 0));
    M = scale(M, point (2, 2, 2));
    point Q = transform(M, transform("shader", P));
    matrix Inv = 1 / M;
    point back = transform(Inv, Q);
    float err = distance(back, transform("shader", P));
    matrix m16 = matrix (1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1);
    setcomp(m16, 3, 0, .5);
    float d = determinant(M);
    color c = err < 1e-4 ? color (mod(xcomp(Q) * 3, 1), mod(ycomp(Q) * 3, 1), d / 10) : color (1, 0, 1);
    if (m16 == matrix 1 || comp(m16, 3, 0) != .5) c = color (1, 0, 1);
    Oi = Os; Ci = Oi * c * (.3 + .7 * diffuse(faceforward(normalize(N), I)));
}
