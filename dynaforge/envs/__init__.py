"""Phase executor, Gymnasium envs, vectorised env, stratified sampler. Light to import: workers start from here."""
