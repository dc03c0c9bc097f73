"""What a run looks like: figure data, pictures, pages and terminal tables. Nothing heavy is imported from here."""
