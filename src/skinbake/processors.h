/* Loops compiled for vectors of several widths. One width is chosen when a module is loaded.

   Compilers offer the same (target_clones), but for glibc alone: the loaders of musl, Windows and macOS do not choose. */

#pragma once

#if defined(_MSC_VER)
#define ALWAYS_INLINE __forceinline
#else
#define ALWAYS_INLINE inline __attribute__((always_inline))
#endif

/* The widest vectors that may be used, in bits. The results are the same bits at any width: tests compile for each. */
#ifndef MOST_BITS
#define MOST_BITS 512
#endif

/* The width in use. A module sets it once, before it can be called. */
static int vector_bits = 128;

/* FOR_PROCESSORS(type, name, parameters, arguments) stands before the body of a function in place of its head. It
   compiles the body for AVX2, too. FOR_WIDE_PROCESSORS compiles it for AVX-512, too, which has twice the registers: loops
   with that mark then take 0.7 to 0.85 of the time. Others gain nothing, or GCC 12 makes them several times slower.

   GCC is left out on Windows, where it does not align the stack for vectors. */
#if defined(__x86_64__) && MOST_BITS > 128 && (defined(__clang__) || (defined(__GNUC__) && !defined(_WIN32)))
#include <cpuid.h>

#define AVX2 __attribute__((target("avx2"))) static
#define AVX512 __attribute__((target("avx2,avx512f,avx512bw,avx512cd,avx512dq,avx512vl"))) static

#define FOR_PROCESSORS(type, name, parameters, arguments)                                                             \
    static ALWAYS_INLINE type name##_text parameters;                                                               \
    AVX2 type name##_by_avx2 parameters { return name##_text arguments; }                                           \
    static type name parameters { return vector_bits > 128 ? name##_by_avx2 arguments : name##_text arguments; }    \
    static ALWAYS_INLINE type name##_text parameters

#define FOR_WIDE_PROCESSORS(type, name, parameters, arguments)                                                        \
    FOR_PROCESSORS(type, name##_narrow, parameters, arguments);                                                    \
    AVX512 type name##_by_avx512 parameters { return name##_narrow_text arguments; }                             \
    static type name parameters { return vector_bits > 256 ? name##_by_avx512 arguments : name##_narrow arguments; } \
    static ALWAYS_INLINE type name##_narrow_text parameters

/* Return the bits of the vectors that both the processor and the system support. */
static int find_vector_bits(void)
{
    unsigned a, b, c, d, kept, high;
    const unsigned asked = bit_OSXSAVE | bit_AVX, halves = 0x06, all = 0xE6;
    const unsigned wide = bit_AVX512F | bit_AVX512BW | bit_AVX512CD | bit_AVX512DQ | bit_AVX512VL;
    if (MOST_BITS < 256 || !__get_cpuid(1, &a, &b, &c, &d) || (c & asked) != asked)
        return 128;
    /* The system must keep both halves of the registers, or all that AVX-512 has, when it switches between threads. */
    __asm__("xgetbv" : "=a"(kept), "=d"(high) : "c"(0));
    if ((kept & halves) != halves || !__get_cpuid_count(7, 0, &a, &b, &c, &d) || !(b & bit_AVX2))
        return 128;
    return MOST_BITS >= 512 && (kept & all) == all && (b & wide) == wide ? 512 : 256;
}
#else
#define FOR_PROCESSORS(type, name, parameters, arguments) static type name parameters
#define FOR_WIDE_PROCESSORS FOR_PROCESSORS
static int find_vector_bits(void) { return 128; }
#endif
