/* Part of the interface: all of it is in hd.h. */
#include "hd.h"
