"""The recipe: what a part should look like, how it is photographed, and how it is judged."""
