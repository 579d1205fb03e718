#ifndef SKINBAKE_DUAL_QUATERNION
#define SKINBAKE_DUAL_QUATERNION
// The unit dual quaternion of a rigid joint matrix. Row [0] is its real part (x, y, z, w), w the scalar; row [1] is
// its dual part. Compute it on the host or in a pass over the joints: once per joint and frame, not per vertex.
// Dual quaternions have no scale. If all joint matrices share a uniform scale s, divide their upper 3x3 parts by
// s first, and skin s * p, s * t0, s * b0 in place of p, t0, b0.
float2x4 skinbake_dual_quaternion(float4x4 M)
{
    float3 d = float3(M[0].x, M[1].y, M[2].z);
    float4 squares = 1.0 + float4( // 4 * (x, y, z, w)^2
        d.x - d.y - d.z, d.y - d.z - d.x, d.z - d.x - d.y, d.x + d.y + d.z);
    float3 differences = float3(M[2].y - M[1].z, M[0].z - M[2].x, M[1].x - M[0].y); // 4 w * (x, y, z)
    float3 sums = float3(M[2].y + M[1].z, M[0].z + M[2].x, M[1].x + M[0].y); // 4 * (yz, zx, xy)
    float4 real = float4(differences, squares.w);
    float largest = squares.w;
    if (squares.x > largest) {
        largest = squares.x;
        real = float4(squares.x, sums.z, sums.y, differences.x);
    }
    if (squares.y > largest) {
        largest = squares.y;
        real = float4(sums.z, squares.y, sums.x, differences.y);
    }
    if (squares.z > largest) {
        real = float4(sums.y, sums.x, squares.z, differences.z);
    }
    real = normalize(real);
    float3 t = float3(M[0].w, M[1].w, M[2].w);
    return float2x4(real, 0.5 * float4(cross(t, real.xyz) + real.w * t, -dot(t, real.xyz)));
}
#endif
