/* Greatest number of actuators; a board may define another before it includes anything. */
#ifndef TACTABLE_LIMITS_H
#define TACTABLE_LIMITS_H

#ifndef TACTABLE_ACTUATORS
#define TACTABLE_ACTUATORS 8u
#endif

#endif
