"""What is shown of a plan, and how it looks: shared by viewer, page, pictures and report."""
