// Between this header and `rounded_as_usual.h` a product that is added to something is rounded before it is added, as
// torch and NumPy do it: elsewhere compilers make one operation of the two, whose last bit is another.
#if defined(__clang__)
#pragma clang fp contract(off)
#else
#pragma GCC push_options
#pragma GCC optimize("fp-contract=off")
#endif
