/* Arctangents of doubles and of floats, by polynomials in t² that are close to arctan t / t for t up to tan(π/8). */

#pragma once

#include "arguments.h"

/* tan(π/8), π/4 and π/2. */
#define TAN_EIGHTH 0.41421356237309503
#define QUARTER 0.78539816339744828
#define HALF 1.5707963267948966

/* Return the arctangent of y / x, both at least 0 and y at most x. The polynomial is off by less than 10⁻¹⁶ of the
   result, which is a rounding. Beyond tan(π/8), arctan t = π/4 + arctan((t − 1) / (t + 1)). */
static ALWAYS_INLINE double arctangent(double y, double x)
{
    const int beyond = y > TAN_EIGHTH * x;
    const double t = (beyond ? y - x : y) / (beyond ? y + x : x), s = t * t;
    double sum = 0.02113551294639468;
    sum = sum * s - 0.043480657562470874;
    sum = sum * s + 0.05688354825090266;
    sum = sum * s - 0.0664023521979754;
    sum = sum * s + 0.07689953677164002;
    sum = sum * s - 0.09090773090639556;
    sum = sum * s + 0.1111110618130427;
    sum = sum * s - 0.14285714181002448;
    sum = sum * s + 0.199999999988555;
    sum = sum * s - 0.3333333333332844;
    sum = sum * s + 1.0;
    return (beyond ? QUARTER : 0.0) + t * sum;
}

/* Return the arctangent of t, at most tan(π/8), to a few units of the last place of a float. */
static ALWAYS_INLINE float small_arctangent(float t)
{
    const float s = t * t;
    float sum = -0.0602630523f;
    sum = sum * s + 0.105698288f;
    sum = sum * s - 0.142395327f;
    sum = sum * s + 0.19998183f;
    sum = sum * s - 0.333333069f;
    sum = sum * s + 0.999999999f;
    return t * sum;
}

/* Return the arctangent of y / x, as above, to the same digits. */
static ALWAYS_INLINE float float_arctangent(float y, float x)
{
    const int beyond = y > (float)TAN_EIGHTH * x;
    return (beyond ? (float)QUARTER : 0.0f) + small_arctangent((beyond ? y - x : y) / (beyond ? y + x : x));
}

/* A little less than the square of tan(π/8). */
#define SMALL_RATIO 0.1715728f

/* Return twice the arctangent of the root of a ratio from 0 to SMALL_RATIO, in degrees: the same as below. */
static ALWAYS_INLINE float degrees_of_small(float ratio)
{
    return small_arctangent(sqrtf(ratio)) * (float)(180.0 / HALF);
}

/* Return twice the arctangent of the root of a ratio of at least 0, in degrees. */
static ALWAYS_INLINE float degrees_of(float ratio)
{
    const float tangent = sqrtf(ratio);
    const float y = tangent < 1.0f ? tangent : 1.0f, x = tangent < 1.0f ? 1.0f : tangent;
    const float acute = float_arctangent(y, x);
    const float angle = tangent > 1.0f ? (float)HALF - acute : acute;
    return angle * (float)(180.0 / HALF);
}
