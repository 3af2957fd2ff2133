"""Out of an archive into files that other programs open: DNG raw files and 16-bit TIFF."""
