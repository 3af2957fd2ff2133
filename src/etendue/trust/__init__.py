"""Whether an archive comes out again: reproduced, compared, repaired."""
