/* Whether a frame with a valid checksum was acted on, and if not, why. */
#ifndef TACTABLE_OUTCOME_H
#define TACTABLE_OUTCOME_H

enum outcome { OUTCOME_ACCEPTED, OUTCOME_STALE, OUTCOME_REFUSED };

#endif
