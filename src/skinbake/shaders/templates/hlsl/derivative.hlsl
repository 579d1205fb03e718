#ifndef SKINBAKE_DERIVATIVE@{ "_CAPPED" if cap is not none }
#define SKINBAKE_DERIVATIVE@{ "_CAPPED" if cap is not none }
// The derivative of p + delta along t, if the mix b changes at the rate db. delta = k h, and i is as in the caller.
//% if cap is none
float3 skinbake_derivative(float2x4 b, float k, float3 p, float3 i, float3 delta, float3 t, float2x4 db)
//% else
float3 skinbake_derivative(float2x4 b, float k, float3 p, float3 i, float3 delta, float3 t, float2x4 db, float cap)
//% endif
{
    float3 di = b[0].w * t + db[1].xyz + cross(b[0].xyz, t) + db[0].w * p + cross(db[0].xyz, p);
    float3 dh = b[0].w * db[1].xyz + cross(b[0].xyz, di) + cross(db[0].xyz, i)
            + db[0].w * b[1].xyz - db[1].w * b[0].xyz - b[1].w * db[0].xyz - dot(b[0], db[0]) * delta;
//% if cap is none
    return t + k * dh;
//% else
    float3 turn = cross(b[0].xyz, b[0].w * t + cross(b[0].xyz, t));
    return skinbake_capped(t + k * turn, k * (dh - turn), cap);
//% endif
}
#endif
