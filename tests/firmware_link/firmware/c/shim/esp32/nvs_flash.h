#include "esp_shim.h"
