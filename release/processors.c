/* What clones of functions ask for when a module is loaded: what the processor can do. zig's own library always says
   that it can do nothing, so no processor would run the clones for its vectors.

   The names, the layout and the number are those of libgcc and of LLVM's compiler-rt. Only AVX2 is told, as the loops
   that zig compiles have clones for nothing else. */

#include <cpuid.h>

#define HIDDEN __attribute__((visibility("hidden")))

enum { FEATURE_AVX2 = 10 };

HIDDEN struct {
    unsigned vendor, type, subtype, features[1];
} __cpu_model;

HIDDEN int __cpu_indicator_init(void)
{
    unsigned a, b, c, d, kept, high;
    const unsigned vectors = bit_OSXSAVE | bit_AVX, both_halves = 6;
    if (!__get_cpuid(1, &a, &b, &c, &d) || (c & vectors) != vectors)
        return 0;
    /* The system must keep both halves of the registers when it switches between threads. */
    __asm__("xgetbv" : "=a"(kept), "=d"(high) : "c"(0));
    if ((kept & both_halves) == both_halves && __get_cpuid_count(7, 0, &a, &b, &c, &d) && (b & bit_AVX2))
        __cpu_model.features[0] = 1u << FEATURE_AVX2;
    return 0;
}
