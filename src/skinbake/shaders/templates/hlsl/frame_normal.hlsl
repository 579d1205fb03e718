#ifndef SKINBAKE_FRAME_FROM_NORMAL
#define SKINBAKE_FRAME_FROM_NORMAL
// The frame that bake took from NORMAL alone. n must have length 1. Every product in a sum is exact, so a compiler
// that fuses multiply-adds gets the same bits. side is the last factor, because Mesa turns side * ((x * x) * a)
// into side * (x * (x * a)).
skinbake_Frame skinbake_frame(float3 n)
{
    float side = n.z >= 0.0 ? 1.0 : -1.0; // 1 also at -0.0
    float a = -1.0 / (side + n.z);
    float b = (n.x * n.y) * a;
    skinbake_Frame frame;
    frame.normal = n;
    frame.tangent = float3(1.0 + ((n.x * n.x) * a) * side, side * b, -side * n.x);
    frame.bitangent = float3(b, side * (1.0 + ((n.y * n.y) * a) * side), -n.y);
    frame.handedness = 1.0;
    return frame;
}
#endif
