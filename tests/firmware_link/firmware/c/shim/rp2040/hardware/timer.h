#include "../pico_shim.h"
