"""Long work in blocks, which may run in threads, shards or on a cluster, and resume.

- `executors`: local, sharded and dry runs of the units of some work
- `work_parts`: resumable parts, merged shards, and pictures rendered in bands
- `staged_parts`: parts of work in stages, as the build of a store
- `scene_records`: JSON records of scenes, lights and cameras, and the digests by which work is recognised
- `warm_ups`: everything that is compiled ahead of time
"""
