"""Archives read: cells, trees, a store verified by its journal, comparisons, inspection."""
