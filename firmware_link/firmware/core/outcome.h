/* What became of a frame with a valid checksum. */
#ifndef TACTABLE_OUTCOME_H
#define TACTABLE_OUTCOME_H

enum outcome { OUTCOME_ACCEPTED, OUTCOME_STALE, OUTCOME_REFUSED };

#endif
