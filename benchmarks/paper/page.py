def write_page(page, images, results): pass
