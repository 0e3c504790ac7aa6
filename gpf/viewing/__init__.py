"""`gpf view`: a page in the browser that shows a scene from a field while photons arrive."""
