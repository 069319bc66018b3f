"""Studies: any comparison as one file, computed job by job."""
