"""Pictures of a run: outlines on the views, a top view, and one page that shows it all."""
