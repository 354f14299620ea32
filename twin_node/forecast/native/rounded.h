// Functions whose sums and products are rounded one by one, as NumPy's are: nothing is fused.
#pragma once

#if defined(__clang__)
#define FORECAST_ROUNDED
#define FORECAST_ROUNDED_BODY _Pragma("clang fp contract(off)")
#else
#define FORECAST_ROUNDED __attribute__((optimize("fp-contract=off")))
#define FORECAST_ROUNDED_BODY
#endif
