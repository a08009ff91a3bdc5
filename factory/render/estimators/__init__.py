"""Estimators of pictures whose display error a job limits; one file and one card each.

choice        selects the cheapest estimator for a shot, from a few samples of it
path_tracing  with as many samples as the shot needs
denoised      path tracing with fewer samples, and Open Image Denoise
ratio         direct light without noise, times a denoised ratio of two pictures
shadow_rays   direct light without noise, times the share that rays find unblocked, and indirect
              light
closed_form   direct light without noise alone, where nothing is blocked
blocked_light  how blocked light bounds the error of closed_form
blends        takes bias out of the last three by a share of the noisy picture
adaptive_sampling  Cycles' own: measured, and not among them
relighting    sums of pictures under a basis of lights: measured, and not among them
self_shading  in factory.render: no shadow rays for any of them where an object cannot shade itself
renderer      what all of them ask of a renderer

error   display L2 (shaders.tone) over the object's mask, of noise and bias together, under the
        exposure that brings the 99th percentile of luminance over the mask to 1
halves  each shot is rendered twice with independent seeds. Both halves together are the picture,
        so that no sample is spent on the estimate of the error, which is what their difference says
Nothing is decided by a clock: the same seed chooses the same estimator on every machine.
"""
