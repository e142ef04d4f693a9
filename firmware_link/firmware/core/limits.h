/* How much this firmware has room for; a board may set it lower or higher before it includes anything. */
#ifndef TACTABLE_LIMITS_H
#define TACTABLE_LIMITS_H

#ifndef TACTABLE_ACTUATORS
#define TACTABLE_ACTUATORS 8u
#endif

#endif
