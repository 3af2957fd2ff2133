"""Display of results: pictures, tables, plots, the page, the terminal."""
