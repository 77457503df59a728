/PROG  ARCS
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "";
PROG_SIZE	= 900;
LINE_COUNT	= 8;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      PAUSE_REQUEST	= 0;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/APPL
/MN
   1:L P[1] 300mm/sec FINE ;
   2:C P[2]    
    :  P[3:end] 200mm/sec CNT100 ;
   3:C P[4]    
    :  P[5] 200mm/sec FINE ACC80 ;
   4:A P[6] 100mm/sec CNT100 ;
   5:A P[7] 100mm/sec CNT100 ;
   6:A P[8] 100mm/sec FINE ;
   7:S P[9] 50mm/sec CNT100 ;
   8:S P[10] 50mm/sec FINE ;
/POS
P[1]{
   GP1:
	UF : 2, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   144.455  mm,	Y =  -257.091  mm,	Z =   443.164  mm,
	W =   156.030 deg,	P =     4.342 deg,	R =    14.714 deg
};
P[2]{
   GP1:
	UF : 2, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   179.900  mm,	Y =  -216.798  mm,	Z =   414.334  mm,
	W =   157.870 deg,	P =     7.089 deg,	R =    26.387 deg
};
P[3:"end"]{
   GP1:
	UF : 2, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   212.269  mm,	Y =  -173.842  mm,	Z =   385.625  mm,
	W =   159.957 deg,	P =     9.391 deg,	R =    38.173 deg
};
P[4]{
   GP1:
	UF : 2, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   241.376  mm,	Y =  -128.495  mm,	Z =   357.085  mm,
	W =   162.209 deg,	P =    11.245 deg,	R =    50.056 deg
};
P[5]{
   GP1:
	UF : 2, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   267.063  mm,	Y =   -81.044  mm,	Z =   328.760  mm,
	W =   164.542 deg,	P =    12.659 deg,	R =    62.006 deg
};
P[6]{
   GP1:
	UF : 2, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   289.198  mm,	Y =   -31.785  mm,	Z =   300.695  mm,
	W =   166.881 deg,	P =    13.663 deg,	R =    73.990 deg
};
P[7]{
   GP1:
	UF : 2, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   307.675  mm,	Y =    18.979  mm,	Z =   272.930  mm,
	W =   169.155 deg,	P =    14.297 deg,	R =    85.972 deg
};
P[8]{
   GP1:
	UF : 2, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   322.416  mm,	Y =    70.941  mm,	Z =   245.505  mm,
	W =   171.311 deg,	P =    14.611 deg,	R =    97.918 deg
};
P[9]{
   GP1:
	UF : 2, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   333.366  mm,	Y =   123.790  mm,	Z =   218.456  mm,
	W =   173.308 deg,	P =    14.662 deg,	R =   109.805 deg
};
P[10]{
   GP1:
	UF : 2, UT : 1,		CONFIG : 'N U T, 0, 0, 0',
	X =   340.501  mm,	Y =   177.215  mm,	Z =   191.816  mm,
	W =   175.125 deg,	P =    14.507 deg,	R =   121.614 deg
};
/END
