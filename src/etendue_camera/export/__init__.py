"""Export from an archive to files that other programs open: DNG raw files, 16-bit TIFF."""
