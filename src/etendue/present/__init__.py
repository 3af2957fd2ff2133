"""Output for people: pictures, tables, plots, the page, the terminal."""
