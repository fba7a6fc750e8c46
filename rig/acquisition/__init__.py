"""What is photographed, in which order, and how it is carried out."""
