// Ends what `rounded_twice.h` began.
#if defined(__clang__)
#pragma clang fp contract(fast)
#else
#pragma GCC pop_options
#endif
