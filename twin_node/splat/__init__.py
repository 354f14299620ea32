"""Rasterising Gaussians: one public function, `rasterize`, with gsplat's signature and semantics."""
