"""A line array of microphones: from sound waves to their direction of arrival."""
