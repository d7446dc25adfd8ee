# glmnet (LASSO, elastic net) as a command, where R is: install.packages(c("glmnet", "jsonlite")).
# In a study file: command = ["Rscript", "solvers/glmnet_solver.R"]

suppressMessages({library(glmnet); library(jsonlite)})

read_npy <- function(path) {  # float64 of one or two dimensions, in either order
  file <- file(path, "rb")
  on.exit(close(file))
  readBin(file, "raw", 8)
  header <- rawToChar(readBin(file, "raw", readBin(file, "integer", 1, 2, FALSE, "little")))
  shape <- as.integer(strsplit(gsub("[^0-9,]", "", sub(".*shape': \\(([^)]*)\\).*", "\\1", header)), ",")[[1]])
  values <- readBin(file, "double", prod(shape), endian = "little")
  if (length(shape) == 1) return(values)
  if (grepl("'fortran_order': True", header)) matrix(values, shape[1]) else matrix(values, shape[1], byrow = TRUE)
}

write_npy <- function(values, shape, path) {  # values in C order
  header <- sprintf("{'descr': '<f8', 'fortran_order': False, 'shape': (%s), }", paste(shape, collapse = ", "))
  header <- paste0(header, strrep(" ", (64 - (nchar(header) + 11) %% 64) %% 64), "\n")
  file <- file(path, "wb")
  on.exit(close(file))
  writeBin(as.raw(c(0x93, utf8ToInt("NUMPY"), 1, 0)), file)
  writeBin(nchar(header), file, 2, endian = "little")
  writeBin(charToRaw(header), file)
  writeBin(values, file, 8, endian = "little")
}

folder <- commandArgs(TRUE)[1]
problem <- fromJSON(file.path(folder, "problem.json"))
if (!problem$kind %in% c("LASSO", "elastic net")) stop("glmnet does not solve this penalty")
X <- read_npy(file.path(folder, "design.npy"))
y <- read_npy(file.path(folder, "target.npy"))[, 1]
# glmnet divides y by its root mean square, and its threshold is of the squared steps.
size <- sqrt(mean(y^2))
input <- file("stdin")
open(input)

cat("ready\n")
flush(stdout())
invisible(readLines(input, 1))
fit <- glmnet(X, y / size, alpha = 1 / (1 + problem$ridge), intercept = FALSE, standardize = FALSE,
              lambda = problem$fractions * (1 + problem$ridge) / size,
              thresh = if (is.null(problem$tolerance)) 1e-14 else problem$tolerance, maxit = 1e8)
cat("done\n")
flush(stdout())

write_npy(size * as.vector(as.matrix(fit$beta)), c(ncol(fit$beta), 1, ncol(X)), file.path(folder, "answer.npy"))
