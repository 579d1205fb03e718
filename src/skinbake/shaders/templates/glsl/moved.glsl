#ifndef SKINBAKE_MOVED
#define SKINBAKE_MOVED
// M p: where the joint matrix M alone takes the position p.
vec3 skinbake_moved(mat4 M, vec3 p)
{
    return M[0].xyz * p.x + (M[1].xyz * p.y + (M[2].xyz * p.z + M[3].xyz));
}
#endif
